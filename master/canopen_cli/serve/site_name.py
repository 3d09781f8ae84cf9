"""The name of a computer, as keys of a fleet and topics of a broker have it."""

from __future__ import annotations

from canopen_cli.shared.options import TextKind
from canopen_gateway.fleet.keys import check_name


class SiteName(TextKind):
    """The name of a site in keys."""

    name = "name"

    def read(self, text: str) -> str:
        return check_name("site", text)
