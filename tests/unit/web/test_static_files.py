"""The page's files: each by its path alone, compressed, not sent again, within their weight, and whole."""

from __future__ import annotations

import gzip
import json
import re
from collections.abc import Iterator
from importlib import resources
from pathlib import Path

import pytest

from polishd.web.http.static_files import COMPRESSED, MEDIA_TYPES, static_files
from tests.unit.web.page_server import Served, served

STATIC = Path(str(resources.files("polishd.web") / "static"))
MOST_BYTES = 1_200_000
"""Permitted size of all files of the page, not compressed."""
IMPORT = re.compile(r"""(?:from|import)\s*\(?["'`](/[^"'`$]+|\./[^"'`$]+|\.\./[^"'`$]+)["'`]""")


@pytest.fixture
def web(tmp_path: Path) -> Iterator[Served]:
    with served(tmp_path) as found:
        yield found


def test_each_file_has_its_type_and_comes_compressed_if_it_is_text(web: Served) -> None:
    for path, file in static_files().items():
        answer = web.ask("GET", path, None, headers={"accept-encoding": "gzip"})
        suffix = "html" if path == "/" else path.rpartition(".")[2]
        assert answer.status_code == 200, path
        assert answer.headers["content-type"] == MEDIA_TYPES[suffix], path
        assert answer.content == file.content, path
        assert (answer.headers.get("content-encoding") == "gzip") is (suffix in COMPRESSED), path
        assert gzip.decompress(file.gzipped()) == file.content


def test_an_unchanged_file_is_not_sent_again(web: Served) -> None:
    first = web.ask("GET", "/page.js", None)
    again = web.ask("GET", "/page.js", None, headers={"if-none-match": first.headers["etag"]})
    other = web.ask("GET", "/page.css", None, headers={"if-none-match": first.headers["etag"]})
    assert (again.status_code, again.content) == (304, b"")
    assert first.headers["cache-control"] == again.headers["cache-control"] == "no-cache"
    assert other.status_code == 200


def test_answers_of_the_api_are_not_stored(web: Served) -> None:
    assert web.ask("GET", "/api/state").headers["cache-control"] == "no-store"


@pytest.mark.parametrize(
    "path",
    ["/index.html", "/../api.py", "/..%2fapi.py", "/vendor/inter/LICENSE", "/vendor/", "/views", "/static/page.js",
     "/vendor/../../api.py", "/views/%2e%2e/page.js%00"],
)  # fmt: skip
def test_no_other_path_is_served(web: Served, path: str) -> None:
    assert web.ask("GET", path, None).status_code in {404, 421}


def test_all_files_together_are_light() -> None:
    sizes = {path: len(file.content) for path, file in static_files().items()}
    assert sum(sizes.values()) < MOST_BYTES, sorted(sizes.items(), key=lambda one: -one[1])[:5]


def test_each_library_has_its_licence_beside_it() -> None:
    for folder in (STATIC / "vendor").iterdir():
        assert any(one.name.startswith("LICENSE") for one in folder.iterdir()), folder.name


def test_every_module_that_is_imported_is_there() -> None:
    served_paths, found = set(static_files()), 0
    for module in [one for one in STATIC.rglob("*.js") if "vendor" not in one.parts]:
        for name in IMPORT.findall(module.read_text()):
            base = STATIC if name.startswith("/") else module.parent
            path = "/" + (base / name.lstrip("/")).resolve().relative_to(STATIC).as_posix()
            assert path in served_paths, f"{module.name} imports {name}"
            found += 1
    assert found > 20


def test_nothing_of_the_page_is_inline_or_from_elsewhere() -> None:
    page = (STATIC / "index.html").read_text()
    assert re.findall(r"<script[^>]*>[^<]", page) == []
    assert re.findall(r"\s(?:style|on\w+)=", page) == []
    assert re.findall(r"(?:src|href)=\"(?!/|#)[^\"]*\"", page) == []


def test_the_page_can_be_installed() -> None:
    manifest = json.loads((STATIC / "polishd.webmanifest").read_text())
    assert manifest["display"] == "standalone"
    assert {"192x192", "512x512"} <= {icon["sizes"] for icon in manifest["icons"]}
    assert all(icon["src"] in static_files() for icon in manifest["icons"])
    assert "serviceWorker" not in "".join(one.read_text() for one in STATIC.glob("*.js"))
