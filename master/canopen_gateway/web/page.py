"""The files of the page, as they are served: from memory, so that no request waits for a disk."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from importlib.resources import files
from typing import Final

KINDS: Final = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
}


@lru_cache(maxsize=1)
def page_files() -> Mapping[str, tuple[bytes, str]]:
    """Return the content and the media type of each file, by its name; "" for the page itself."""
    found: dict[str, tuple[bytes, str]] = {}
    for file in files("canopen_gateway.web").joinpath("static").iterdir():
        kind = KINDS.get(file.name[file.name.rfind(".") :])
        if kind is not None:
            found[file.name] = file.read_bytes(), kind
    found[""] = found.pop("index.html")
    return found
