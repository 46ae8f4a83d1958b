"""The documents as a site: ``make docs``. Every broken link is an error."""

from importlib.metadata import version as installed
from pathlib import Path

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx
from sphinx.writers.html5 import HTML5Translator

# autodoc writes annotations into pydantic's base class, after which some models cannot be made
import protocol.scenario  # noqa: F401
from tools import command_reference, scenario_reference

project = "wyner"
copyright = "the wyner maintainers"
version = release = installed("wyner")

extensions = ["myst_parser", "sphinx.ext.apidoc", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
exclude_patterns = ["data", "figures"]
myst_heading_anchors = 4
myst_enable_extensions = ["dollarmath"]
html_math_renderer = "mathml"
suppress_warnings = [
    "ref.python",  # one name in two modules: the type in a signature stays unlinked
]
html_theme = "furo"
html_title = "wyner"
html_static_path: list[str] = []

napoleon_google_docstring = False
napoleon_use_ivar = True
autodoc_typehints = "signature"
autodoc_member_order = "bysource"
autodoc_default_options = {"ignore-module-all": True}  # each thing at its own place
apidoc_modules = [
    {
        "path": f"../{room}",
        "destination": f"api/{room}",
        "exclude_patterns": ["**/__main__.py"],
        "separate_modules": True,
        "module_first": True,
    }
    for room in (
        "protocol",
        "runtime",
        "controller_service",
        "plant_service",
        "tap_service",
        "attacker_service",
        "wyner",
    )
]


def write_references(app: Sphinx) -> None:
    """The pages of all commands and of all scenario fields are made from the code."""
    pages = {"command": command_reference.page(), "scenario": scenario_reference.page()}
    for name, text in pages.items():
        (Path(app.srcdir) / f"{name}-reference.md").write_text(text, encoding="utf-8")


def show_diagrams(_app: object, doctree: nodes.document) -> None:
    """Mermaid's sources, which the forges draw, stand on the site as they are: no script is run."""
    for block in list(doctree.findall(nodes.literal_block)):
        if block.get("language") == "mermaid":
            block["language"] = "text"


def inline_formula(self: HTML5Translator, node: nodes.math) -> None:
    """A formula as MathML, which a browser draws without a script and without the network."""
    self.body.append(tex2mathml(node.astext()))
    raise nodes.SkipNode


def displayed_formula(self: HTML5Translator, node: nodes.math_block) -> None:
    """The same on a line of its own."""
    self.body.append(tex2mathml(node.astext(), as_block=True))
    raise nodes.SkipNode


def setup(app: Sphinx) -> None:
    """Called by Sphinx."""
    app.add_html_math_renderer("mathml", (inline_formula, None), (displayed_formula, None))
    app.connect("builder-inited", write_references)
    app.connect("doctree-read", show_diagrams)
