"""`Reply`: the answer of a service. Errors of the master become its text, with ROS names in place of Python calls."""

from __future__ import annotations

import re
from typing import Final, NamedTuple

from canopen_data import DataError
from canopen_data.findings import DictionaryError
from canopen_master.errors import MasterError
from canopen_master.simulation.hooks import ScriptError
from canopen_proto.machine import LocalProtocolError
from canopen_proto.procedures.steps import ProcedureError

COMMAND_ERRORS: Final = (MasterError, LocalProtocolError, ProcedureError)
"""A command that fails, or is refused, raises one of these. Anything else is a mistake in the program."""
FILE_ERRORS: Final = (DataError, DictionaryError, ScriptError)
"""A machine whose files cannot be used raises one of these when it is opened, or simulated."""


class Reply(NamedTuple):
    """The answer of a service. message: for people; of a failure the whole text of the error, with its code.

    value: of an object, as text; empty for other services.
    """

    success: bool
    message: str
    value: str = ""


_CALL: Final = re.compile(r"(?:await )?chain\.(\w+)\([^()]*\)")
_SERVICES: Final = {
    "initialise": "{chain}/init",
    "home": "{chain}/home",
    "recover": "{chain}/recover",
    "shut_down": "{chain}/shutdown",
    "halt": "{chain}/halt",
    "follow": "{chain}/recover",
    "move": "a trajectory",
}
"""The service that does the same, by the method of a chain."""


def text_of(error: BaseException, chain: str) -> str:
    """Return the text of an error. The calls of a chain in it become the services of the chain with this name."""

    def service(match: re.Match[str]) -> str:
        return _SERVICES.get(match[1], match[0]).format(chain=chain)

    return _CALL.sub(service, str(error))
