"""XDD files for tests, put together from the parts that a test is about."""

from __future__ import annotations

from canopen_data.description import DeviceDescription
from canopen_data.xdd import read_xdd

HEAD = '<?xml version="1.0" encoding="utf-8"?><ISO15745ProfileContainer xmlns="http://www.canopen.org/xml/1.1">\n'
VAR = '<CANopenObject index="{0}" name="{1}" objectType="7" {2}/>\n'


def xdd(
    objects: str = "", process: str = "", *, layers: str = "", network: str = "", identity: str = "", body: str = ""
) -> bytes:
    """A container with a device profile and a communication network profile."""
    return (
        f"{HEAD}<ISO15745Profile><ProfileBody {body}>"
        f"<DeviceIdentity>{identity}</DeviceIdentity><ApplicationProcess>{process}</ApplicationProcess>"
        f"</ProfileBody></ISO15745Profile>\n<ISO15745Profile><ProfileBody {body}><ApplicationLayers><CANopenObjectList>\n"
        f"{objects}</CANopenObjectList>{layers}</ApplicationLayers>{network}</ProfileBody></ISO15745Profile>"
        f"\n</ISO15745ProfileContainer>\n"
    ).encode()


def var(attributes: str, index: str = "2000", name: str = "thing") -> str:
    """A CANopenObject that is a VAR."""
    return VAR.format(index, name, attributes)


def read(objects: str = "", process: str = "", **parts: str) -> DeviceDescription:
    """The description of such a file."""
    return read_xdd(xdd(objects, process, **parts), "my.xdd")


def told(description: DeviceDescription) -> list[str]:
    """The codes and places of its findings."""
    return [f"{each.line}:{each.column} {each.severity} {each.code}" for each in description.findings]
