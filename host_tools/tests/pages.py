"""Pages as they stand without scripts; tests/browser runs those."""

from __future__ import annotations

import re


def without_scripts(page: str) -> str:
    return re.sub(r"<script\b[^>]*>.*?</script>\n?", "", page, flags=re.DOTALL)
