"""Pages from templates; `page.html.j2` is what all pages share."""

from __future__ import annotations

import jinja2

from .numbers import tight


def environment(package: str) -> jinja2.Environment:
    """The templates of a package, which may extend those beside this module."""
    loaders = [jinja2.PackageLoader(one) for one in dict.fromkeys((package, __package__))]
    made = jinja2.Environment(loader=jinja2.ChoiceLoader(loaders), undefined=jinja2.StrictUndefined, autoescape=True,
                              trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True)
    made.filters["tight"] = tight
    return made
