"""A device of one's own from its Python file: the class that the file declares."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from canopen_data.named_files import read_text
from canopen_master.simulation.hooks import Script, ScriptError
from canopen_proto.declared import DeclaredDevice

SUFFIX: Final = ".py"


def load_device(path: str) -> type[DeclaredDevice]:
    """Run a Python file, and return the device that it declares: its only `DeclaredDevice` with a nameplate, or its last one.

    Raises DataError if it cannot be read, ScriptError if it fails or declares no device.
    """
    script = Script(read_text(Path(path)), path)
    names = script.run()
    found = [each for each in names.values() if isinstance(each, type) and issubclass(each, DeclaredDevice)]
    own = [each for each in found if each.__module__ == names["__name__"] and hasattr(each, "nameplate")]
    if not own:
        raise ScriptError(path, "it declares no device: a class that inherits from DeclaredDevice and has a nameplate")
    return own[-1]
