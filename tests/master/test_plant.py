"""Plant files: which simulated devices stand on a bus."""

from __future__ import annotations

import pytest

from canopen_data.findings import DictionaryError
from canopen_master.simulation.plant import DeviceEntry, parse_plant

TEXT = """
bus = "udp_multicast"
state = "state.json"

[[device]]
file = "drive.eds"
id = 5
profile = "402"
shape = "schunk"
script = "animate.py"
overlay = "units.toml"
defaults = true
[device.values]
1017 = 500
"identity_object:serial_number" = 4711

[[device]]
file = "io.dcf"

[[device]]
file = "io.eds"
id = [6, 7]
overlay = ["a.toml", "b.toml"]
"""


def test_a_plant() -> None:
    plant = parse_plant(TEXT)
    assert (plant.bus, plant.state) == ("udp_multicast", "state.json")
    values = {"1017": 500, "identity_object:serial_number": 4711}
    assert plant.devices == (
        DeviceEntry("drive.eds", (5,), "402", "schunk", "animate.py", ("units.toml",), True, values),
        DeviceEntry("io.dcf"),
        DeviceEntry("io.eds", (6, 7), overlays=("a.toml", "b.toml")),
    )


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("", "p.toml: error: device: there is none: [[device]] begins one [plant]"),
        ("[[device]", "p.toml:1:9: error: Expected ']]' at the end of an array declaration [toml]"),
        ("buss = 1", "p.toml: error: plant: there is no entry 'buss'; did you mean bus? [plant]"),
        ("bus = 1", "p.toml: error: bus: a bus is expected, not 1 [plant]"),
        ("[device]\nfile = 'a'", "p.toml: error: device: [[device]] is expected, not {'file': 'a'} [plant]"),
        ("[[device]]", "p.toml: error: device 1: it has no file [plant]"),
        ("[[device]]\nfile = ''", "p.toml: error: device 1: file: a file name is expected, not '' [plant]"),
    ],
)
def test_what_is_wrong(text: str, error: str) -> None:
    with pytest.raises(DictionaryError) as caught:
        parse_plant(text, "p.toml")
    assert caught.value.failed == error


@pytest.mark.parametrize(
    "entry",
    [
        "id = 0", "id = 128", "id = true", "id = []", "id = [1, 'x']", "profile = 402", "shape = 'round'", "script = 5",
        "overlay = [5]", "defaults = 1", "values = 5", "idd = 5",
    ],
)  # fmt: skip
def test_entries_of_the_wrong_kind(entry: str) -> None:
    with pytest.raises(DictionaryError, match="device 1: "):
        parse_plant(f"[[device]]\nfile = 'a.eds'\n{entry}\n")


def test_all_errors_in_one_pass_and_not_without_end() -> None:
    with pytest.raises(DictionaryError) as caught:
        parse_plant("x = 1\n" + "[[device]]\nid = 0\n" * 200)
    assert len(caught.value.findings) == 2 + 127 * 2
    assert "device: there are 200; a bus has 127 node-IDs" in str(caught.value.findings[1])
