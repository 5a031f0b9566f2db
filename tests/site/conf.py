"""The site: the README files as they are, and three pages made of the sources. `build.sh` calls Sphinx with this.

Sphinx takes the checkout as its source directory, so that links between README files hold on the site too. Only what
Debian 12 (Sphinx 5.3, MyST 0.18) and Debian 13 (8.1, 4.0) have in common is used.
"""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import re
import textwrap
from collections.abc import Iterator
from pathlib import Path

import click
from docutils import nodes
from sphinx.application import Sphinx

import rdpi
from rdpi.cli import main

ROOT = Path(__file__).resolve().parents[2]
SITE = "tests/site"
HEADERS = [path for folder in ("lib/include/rdpi", "port/include", "port/drivers")
           for path in sorted((ROOT / folder).glob("*.h"))]
REFERENCE = "c", "commands", "python"

project = "rdpi"
version = release = rdpi.version()
root_doc = "README"
exclude_patterns = ["build*", ".*", "**/.*", "host_tools/build", "host_tools/*.egg-info"]
include_patterns = ["README.md", "CHANGELOG.md", "CONTRIBUTING.md", "*/README.md", "*/*/README.md", "host_tools/formats.md",
                    "host_tools/terms.md", "lib/SAFETY.md", f"{SITE}/*.rst"]
extensions = ["myst_parser", "breathe", "sphinx.ext.autodoc"]
myst_heading_anchors = 4
breathe_projects = {"rdpi": str(ROOT / "build/site/doxygen/xml")}
breathe_default_project = "rdpi"
breathe_domain_by_extension = {"h": "c"}
autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
suppress_warnings = ["ref.python"]  # types in signatures: what two packages export has two places, either will do
highlight_language = "none"
smartquotes = False  # -- begins an option
html_theme = "furo"
html_title = f"rdpi {release}"
html_copy_source = html_show_sphinx = html_show_copyright = False
html_static_path = ["site.css"]
html_css_files = ["site.css"]


# ---- pages made of the sources ----


def c() -> Iterator[str]:
    """A section for every public header."""
    for path in HEADERS:
        yield from (f".. _{path.name}:", "", path.name, "-" * len(path.name), "", f".. doxygenfile:: {path.name}", "")


def commands() -> Iterator[str]:
    """A section for every command: what its --help says."""
    program = click.Context(main, info_name="rdpi", **main.context_settings)
    yield from help_of(main, program)
    for name, command in sorted(main.commands.items()):
        yield from (f".. _rdpi-{name}:", "", f"rdpi {name}", "-" * 40, "")
        yield from help_of(command, click.Context(command, info_name=name, parent=program))


def help_of(command: click.Command, context: click.Context) -> Iterator[str]:
    yield from literal(f"Usage: {context.command_path} {' '.join(command.collect_usage_pieces(context))}")
    for paragraph in inspect.cleandoc(command.help or "").split("\n\n"):
        marked = paragraph.startswith("\b\n")  # click: leave the lines as they are
        yield from literal(paragraph.removeprefix("\b\n")) if marked else (*plain(paragraph), "")
    for parameter in command.get_params(context):
        record = parameter.get_help_record(context)
        if record:
            yield from (f"``{record[0]}``", textwrap.indent("\n".join(plain(record[1])), "    "), "")


def literal(text: str) -> Iterator[str]:
    yield from ("::", "", textwrap.indent(text, "    "), "")


def packages() -> list[str]:
    """rdpi, its rooms and what is a package in them."""
    below = pkgutil.walk_packages(rdpi.__path__, "rdpi.")
    return ["rdpi", *(found.name for found in below if found.ispkg)]


def exported(package: str) -> list[str]:
    """The names that a package lets others use."""
    module = importlib.import_module(package)
    named = getattr(module, "__all__", None)
    if named is None:
        named = [name for name, value in vars(module).items() if not name.startswith("_") and not inspect.ismodule(value)
                 and getattr(value, "__module__", "").startswith("rdpi")]
    return sorted(named, key=str.lower)


def python() -> Iterator[str]:
    """A section for every package, with what it exports, and for every module that it exports whole."""
    shown = set()
    for package in packages():
        module = importlib.import_module(package)
        yield from (package, "-" * len(package), "", f".. py:module:: {package}", "")
        yield from (*plain(inspect.getdoc(module) or ""), "")
        modules = []
        for name in exported(package):
            value = getattr(module, name)
            if inspect.ismodule(value):
                modules += [value.__name__] * (not hasattr(value, "__path__"))  # packages have their own section
            elif inspect.isclass(value):
                again = value in shown
                shown.add(value)
                yield from ((f":py:class:`rdpi.{name}`", "") if again else
                            (f".. autoclass:: {package}.{name}", "   :members:", ""))
            elif inspect.isroutine(value):
                yield from (f".. autofunction:: {package}.{name}", "")
            else:
                yield f".. py:data:: {name}"
                if isinstance(value, (int, float, str, tuple)):
                    yield f"   :value: {value!r}"
                yield ""
        for name in modules:  # what the package exports itself is above
            above = ", ".join(sorted(set(exported(package)) & set(vars(importlib.import_module(name)))))
            yield from (name, "~" * len(name), "", f".. automodule:: {name}", "   :members:")
            yield from (f"   :exclude-members: {above}" if above else "", "")


def plain(text: str) -> list[str]:
    """Docstrings are text with `names` in it, not reStructuredText: lines further in are shown as they are."""
    lines, found, inside = text.splitlines(), [], False
    for k, line in enumerate(lines):
        if line.startswith("    ") and not inside and (k == 0 or not lines[k - 1].strip()):
            found += ["::", ""]
            inside = True
        elif line.strip() and not line.startswith("    "):
            inside = False
        if not inside:
            line = line.strip() if not re.match(r"[*-] |  ", line) else line
            line = "".join(f"``{part}``" if odd % 2 else re.sub(r"([*|\\]|_\b)", r"\\\1", part)
                           for odd, part in enumerate(re.split(r"`([^`]+)`", line)))
        found.append(line)
    return found


# ---- Sphinx calls these ----


def add_what_is_made(app: Sphinx, page: str, source: list[str]) -> None:
    """A README lists the pages below it; links to folders lead to their README, links to headers to their section."""
    name = page.removeprefix(f"{SITE}/")
    if name in REFERENCE:
        source[0] += "\n" + "\n".join({"c": c, "commands": commands, "python": python}[name]()) + "\n"
        return
    folder = (ROOT / page).parent
    source[0] = re.sub(r"\]\(([^)#:\s]+)(#[^)\s]*)?\)", lambda match: f"]({target(folder, match[1])}{match[2] or ''})",
                       source[0])
    pages = sorted(str(Path(found).relative_to(Path(page).parent)) for found in app.env.found_docs
                   if page.endswith("README") and found != page and is_below(found, page))
    if page == "README":
        order = ["lib/README", "host_tools/README", "port/README", "examples/README", "tests/README", "CONTRIBUTING",
                 "CHANGELOG"]
        source[0] += tree([one for one in order if one in pages]) + tree(f"{SITE}/{one}" for one in REFERENCE)
    elif pages:
        source[0] += tree(pages)


def tree(pages: Iterator[str] | list[str]) -> str:
    return "\n\n```{toctree}\n:hidden:\n\n" + "\n".join(pages) + "\n```\n"


def is_below(page: str, readme: str) -> bool:
    """Whether a page is one level below this README."""
    if readme == "README":
        return page.count("/") == (1 if page.endswith("/README") else 0)
    beside = str(Path(page).parent) if not page.endswith("/README") else str(Path(page).parent.parent)
    return beside == str(Path(readme).parent)


def target(folder: Path, link: str) -> str:
    path = folder / link
    if path.is_dir() and (path / "README.md").exists():
        return f"{link.rstrip('/')}/README.md"
    return path.name if path.resolve() in HEADERS else link


def docstring(app: Sphinx, what: str, name: str, thing: object, options: object, lines: list[str]) -> None:
    """Of a NamedTuple's fields, Python says no more than their number."""
    lines[:] = [] if lines[:1] and lines[0].startswith("Alias for field number") else plain("\n".join(lines))


def signature(app: Sphinx, what: str, name: str, thing: object, options: object, arguments: str | None,
              returns: str | None) -> tuple[str | None, str | None]:
    """A default that is no expression, such as <factory>, is shown as ...: otherwise Sphinx cannot read the signature."""
    return arguments and re.sub(r"= ?<(?:[^<>]|<[^<>]*>)*>", "= ...", arguments), returns


def join_paragraphs(app: Sphinx, doctree: nodes.document) -> None:
    """Breathe 4.34 puts paragraphs into paragraphs, which a browser shows as a break in the middle of a sentence."""
    for paragraph in [*doctree.findall(nodes.paragraph)]:
        if isinstance(paragraph.parent, nodes.paragraph):
            paragraph.parent.replace(paragraph, paragraph.children)


def front_page(app: Sphinx, error: Exception | None) -> None:
    """index.html leads to README.html, which links between pages name."""
    if error is None:
        text = ('<!DOCTYPE html>\n<meta charset="utf-8"><meta http-equiv="refresh" content="0; url=README.html">\n'
                '<title>rdpi</title><a href="README.html">rdpi</a>\n')
        (Path(app.outdir) / "index.html").write_text(text, encoding="utf-8")


def setup(app: Sphinx) -> None:
    app.connect("source-read", add_what_is_made)
    app.connect("autodoc-process-docstring", docstring)
    app.connect("autodoc-process-signature", signature)
    app.connect("doctree-read", join_paragraphs)
    app.connect("build-finished", front_page)
