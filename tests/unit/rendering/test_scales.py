"""One rule for the colors of maps: the page's tables are the reports', and a scale has two ends."""

from __future__ import annotations

import re
from importlib import resources

import matplotlib as mpl
import numpy as np
import pytest

from polishd.rendering.scales import DIVERGING, SEQUENTIAL, value_limits

SCRIPT = (resources.files("polishd.web") / "static" / "maps" / "colormap.js").read_text()
NAMES = {"diverging": DIVERGING, "cividis": SEQUENTIAL, "viridis": "viridis", "gray": "gray"}


def test_the_page_has_the_colors_of_the_reports() -> None:
    for name, table in NAMES.items():
        found = re.search(rf"^  {name}: (.*?),$", SCRIPT, re.MULTILINE | re.DOTALL)
        assert found is not None, name
        text = "".join(re.findall(r'"([0-9a-f]+)"', found[1]))
        colors = [[int(text[k + 2 * c : k + 2 * c + 2], 16) for c in range(3)] for k in range(0, len(text), 6)]
        wanted = [mpl.colormaps[table](k / (len(colors) - 1))[:3] for k in range(len(colors))]
        assert np.abs(np.array(colors) - 255 * np.array(wanted)).max() <= 1, name
    assert f'tableOf = (signed) => (signed ? "diverging" : "{SEQUENTIAL}")' in SCRIPT


def test_values_without_a_sign_end_at_a_percentile() -> None:
    values = np.r_[np.linspace(0.0, 1.0, 1000), 50.0, np.nan]
    low, high = value_limits(values, 99.5)
    assert low == 0.0
    assert high == pytest.approx(1.0, abs=0.01)
    assert value_limits(values) == (0.0, 50.0)


@pytest.mark.parametrize("values", [[], [np.nan], [3.0, 3.0]])
def test_a_scale_has_two_ends(values: list[float]) -> None:
    low, high = value_limits(np.array(values))
    assert low < high
