"""Build of the documentation site with Sphinx and MyST: ``make docs``, into build/docs."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml
from pygments.lexers.special import TextLexer

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))  # the source of the API reference

project = "polishd"
author = "The polishd developers"
copyright = author  # noqa: A001 (Sphinx reads this name)
html_title = "polishd"

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["data", "contributing/patches", "requirements.*"]
html_theme = "furo"
html_copy_source = False
html_show_sphinx = False
html_math_renderer = "mathml"
html_theme_options = {"navigation_with_keys": True}
templates_path: list[str] = []

myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 4

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
python_maximum_signature_line_length = 100
add_module_names = False


def setup(app: Any) -> dict[str, bool]:
    """Register equations as MathML, which browsers render without scripts or fonts from elsewhere."""
    app.add_lexer("vectors", TextLexer)  # test vectors of docs/protocols
    app.add_html_math_renderer("mathml", (_inline_math, None), (_block_math, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _inline_math(translator: Any, node: Any) -> None:
    _write_math(translator, node, as_block=False)


def _block_math(translator: Any, node: Any) -> None:
    translator.body.append('<div class="math">')
    _write_math(translator, node, as_block=True)
    translator.body.append("</div>")


def _write_math(translator: Any, node: Any, *, as_block: bool) -> None:
    translator.body.append(tex2mathml(node.astext(), as_block=as_block))
    raise nodes.SkipNode
