"""The site builds without a warning, its links lead somewhere, and what is public is on it."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import re
import subprocess
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import click
import pytest

import rdpi
from rdpi.cli import main

ROOT = Path(__file__).resolve().parents[2]
HTML = ROOT / "build/site/html"
HEADERS = sorted(path for folder in ("lib/include", "port/include", "port/drivers") for path in (ROOT / folder).rglob("*.h"))
COMMENT = re.compile(r"/\*.*?\*/|//[^\n]*", re.DOTALL)
FUNCTION = re.compile(r"^(?:static inline )?(?:const )?\w+[ *]+(rdpi_\w+)\(", re.MULTILINE)
PACKAGES = ["rdpi", *(found.name for found in pkgutil.walk_packages(rdpi.__path__, "rdpi.") if found.ispkg)]


class Page(HTMLParser):
    """The places of a page that a link may name, its links, and its text."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.ids: set[str] = set()
        self.links: list[str] = []
        self.text = ""
        self.feed(html)

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        given = dict(attributes)
        self.ids |= {given[name] for name in ("id", "name") if given.get(name)}
        self.links += [given[name] for name in ("href", "src") if given.get(name)]

    def handle_data(self, data: str) -> None:
        self.text += data


@cache
def page(path: Path) -> Page:
    return Page(path.read_text(encoding="utf-8"))


def broken_links(folder: Path) -> list[str]:
    """Links of the pages in a folder to files and places that are not there; links to other sites are not followed."""
    found = []
    for path in sorted(folder.rglob("*.html")):
        for link in page(path).links:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            to = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            if not to.is_file() or parts.fragment and to.suffix == ".html" and \
                    unquote(parts.fragment) not in page(to).ids:
                found.append(f"{path.relative_to(folder)}: {link}")
    return found


@pytest.fixture(scope="module")
def site() -> Path:
    """Made anew. Every warning of Doxygen, Breathe, MyST and Sphinx fails it."""
    done = subprocess.run([ROOT / "tests/site/build.sh"], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return HTML


@pytest.mark.slow
def test_every_link_leads_somewhere(site: Path) -> None:
    assert len(page(site / "README.html").links) > 20
    assert broken_links(site) == []


def test_a_link_that_leads_nowhere_is_seen(tmp_path: Path) -> None:
    (tmp_path / "a.html").write_text('<p id="here"><a href="a.html#here"><a href="b.html"><a href="#there">'
                                     '<a href="https://example.org/x"><img src="c.png">')
    assert broken_links(tmp_path) == ["a.html: b.html", "a.html: #there", "a.html: c.png"]


@pytest.mark.slow
def test_every_readme_is_a_page(site: Path) -> None:
    listed = subprocess.run(["git", "ls-files", "--", "README.md", "*/README.md", "C*.md"], cwd=ROOT, capture_output=True,
                            text=True).stdout.split()
    expected = listed or ["README.md", "lib/README.md", "CONTRIBUTING.md", "CHANGELOG.md"]
    assert [name for name in expected if not (site / name).with_suffix(".html").exists()] == []


@pytest.mark.slow
@pytest.mark.parametrize("header", HEADERS, ids=lambda path: path.name)
def test_every_public_c_function_is_on_it(site: Path, header: Path) -> None:
    declared = set(FUNCTION.findall(COMMENT.sub("", header.read_text(encoding="utf-8"))))
    assert {name for name in declared if f"c.{name}" not in page(site / "tests/site/c.html").ids} == set()


def test_functions_are_found_in_headers() -> None:
    found = {name for header in HEADERS for name in FUNCTION.findall(COMMENT.sub("", header.read_text(encoding="utf-8")))}
    assert {"rdpi_f32_init", "rdpi_f32_step", "rdpi_q31_get_memory", "rdpi_port_write_dac", "rdpi_spi_busy"} <= found


@pytest.mark.slow
@pytest.mark.parametrize("name", main.commands)
def test_every_command_and_option_is_on_it(site: Path, name: str) -> None:
    commands = page(site / "tests/site/commands.html")
    assert f"rdpi-{name}" in commands.ids
    section = " ".join(commands.text.partition(f"Usage: rdpi {name} ")[2].partition("Usage: ")[0].split())
    options = [one for one in main.commands[name].params if isinstance(one, click.Option)]
    said = [text for one in options for text in (*one.opts, " ".join((one.help or "").replace("`", "").split()))]
    assert len(said) > 2 and [text for text in said if text not in section] == []


@pytest.mark.slow
@pytest.mark.parametrize("package", PACKAGES)
def test_the_python_interface_is_on_it(site: Path, package: str) -> None:
    places = page(site / "tests/site/python.html").ids
    module = importlib.import_module(package)
    names = getattr(module, "__all__", None) or [
        name for name, value in vars(module).items()
        if not name.startswith("_") and getattr(value, "__module__", "").startswith("rdpi")]
    assert f"module-{package}" in places
    for name in names:
        value = getattr(module, name)
        first = "rdpi" if getattr(rdpi, name, None) is value else package  # what `rdpi` exports too is shown there
        assert (f"module-{value.__name__}" if inspect.ismodule(value) else f"{first}.{name}") in places, name
