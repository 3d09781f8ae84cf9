"""`--allow`: what clients of a door may change."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import click

from canopen_cli.shared.options import F, TextKind
from canopen_gateway import Permission, parse_permissions


class Permissions(TextKind):
    """What clients may change: "write,nmt"."""

    name = "kinds"

    def read(self, text: str) -> frozenset[Permission]:
        return parse_permissions(text)


def allow_option(what: str) -> Callable[[F], F]:
    """Return the option `--allow`. what: the beginning of its help: what may be changed, and of which kind."""
    return click.option("--allow", type=Permissions(), default="", metavar="KINDS", help=f"{what}. By default nothing.")


allowing: Final = allow_option("What clients may change: write, motion, store, program, nmt, lss")
