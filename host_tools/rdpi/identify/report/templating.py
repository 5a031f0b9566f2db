"""Pages from templates; `page.html.j2` is what all pages share."""

from __future__ import annotations

from functools import cache
from importlib import resources

import jinja2
import markupsafe

from .numbers import tight

PLOTS = "echarts/echarts.min.js", "templates/plots.js"  # of every page


def environment(package: str) -> jinja2.Environment:
    """The templates of a package, which may extend those beside this module."""
    loaders = [jinja2.PackageLoader(one) for one in dict.fromkeys((package, __package__))]
    made = jinja2.Environment(loader=jinja2.ChoiceLoader(loaders), undefined=jinja2.StrictUndefined, autoescape=True,
                              trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True)
    made.filters["tight"] = tight
    made.globals["plots"] = _plots
    return made


@cache
def _plots() -> markupsafe.Markup:
    """The script of every page: a megabyte, read once a page is written and not whenever the commands start."""
    return markupsafe.Markup("\n".join(
        resources.files(__package__).joinpath(part).read_text(encoding="utf-8") for part in PLOTS))
