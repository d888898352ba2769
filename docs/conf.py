"""The site of `make docs`: the pages as they are, notebooks executed, the reference from docstrings."""

import os
import re
import sys
import tempfile
from importlib import metadata
from pathlib import Path
from typing import Any

from surefoot.experiments.study.figures import DPI, STYLE, look_of

sys.path.insert(0, str(Path(__file__).parent))  # where study_tables is, and for notebooks gallery_figures
os.environ["PYTHONPATH"] = os.pathsep.join([sys.path[0], *filter(None, [os.environ.get("PYTHONPATH")])])

project, author, release = "surefoot", "", metadata.version("surefoot")
html_title = f"surefoot {release}"
html_theme = "sphinx_book_theme"
html_theme_options = {"navigation_with_keys": False, "navbar_persistent": []}
html_show_copyright = False
html_static_path, html_css_files = ["_static"], ["surefoot.css"]
repository = metadata.metadata("surefoot")["Project-URL"].partition(", ")[2]
if "/OWNER/" not in repository:
    html_theme_options |= {"repository_url": repository, "use_repository_button": True}

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.mathjax", "study_tables"]
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 4  # links name headings as on GitHub

# A tutorial that fails is a site that is not built.
nb_execution_mode = "force"
nb_execution_in_temp = nb_execution_raise_on_error = True
nb_execution_timeout = 120

# Figures of notebooks look as those of studies do.
_COLOURS = [
    look_of(name).colour for name in ("moment", "none", "window", "quasi-static", "tare", "reference")
]
_MATPLOTLIB = Path(tempfile.mkdtemp()) / "matplotlibrc"
_MATPLOTLIB.write_text(
    "".join(f"{name}: {value}\n" for name, value in STYLE.items() if name != "svg.hashsalt")
    + f"figure.dpi: {DPI}\naxes.prop_cycle: cycler('color', {[colour[1:] for colour in _COLOURS]})\n"
)
os.environ["MATPLOTLIBRC"] = str(_MATPLOTLIB)

autodoc_default_options = {"members": True, "imported-members": True}
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented_params"
default_role = "code"
toc_object_entries_show_parents = "hide"
napoleon_custom_sections = [("Attributes", "params_style")]


def _links_of_the_root(app: Any, path: Any, parent: str, content: list[str]) -> None:
    """Let pages that are included from the root (README and others) link from docs/."""
    text = re.sub(r"\]\((?!https?:|#)", "](../", content[0])
    content[0] = re.sub(r"\.\./(CHANGELOG|CONTRIBUTING)\.md", lambda name: name[1].lower() + ".md", text)


def _docstring(app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Make Sphinx's tables of those in docstrings, which are written as in Markdown."""
    for i in reversed([i for i, line in enumerate(lines) if line.startswith("|")]):
        cells = [cell.strip() for cell in lines[i].strip("| ").split("|")]
        lines[i : i + 1] = [f"   {' ' if j else '*'} - {cell}" for j, cell in enumerate(cells)]
        if set("".join(cells)) <= set("-:"):
            del lines[i : i + len(cells)]
        elif i == 0 or not lines[i - 1].startswith("|"):
            lines[i:i] = [".. list-table::", "   :header-rows: 1", ""]
    if what in ("attribute", "property"):
        lines[:0] = [""]  # Napoleon takes a word before a colon in the first line for a type.


def _skips(app: Any, what: str, name: str, obj: Any, skip: bool, options: Any) -> bool | None:
    """Leave out fields of named tuples, which are under Attributes already."""
    return True if (obj.__doc__ or "").startswith("Alias for field number") else None


def setup(app: Any) -> None:
    """Have Sphinx call the functions above."""
    app.connect("include-read", _links_of_the_root)
    app.connect("autodoc-process-docstring", _docstring, priority=400)
    app.connect("autodoc-skip-member", _skips)
