"""`Permissions`: the values of --allow."""

from __future__ import annotations

from typing import Any

import click

from canopen_cli.shared.options import Kind
from canopen_gateway import Permission, parse_permissions


class Permissions(Kind):
    """What clients may change: "write,nmt"."""

    name = "kinds"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> frozenset[Permission]:
        if isinstance(value, frozenset):
            return value
        try:
            return parse_permissions(str(value))
        except ValueError as error:
            self.fail(str(error), param, ctx)
