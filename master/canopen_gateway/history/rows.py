"""The rows of a history: one for each value, state, emergency and gap.

A value stands exactly in one of three columns, as its type has it: `integer` (also BOOLEAN: 0 or 1; all 64 bits, with and without
sign), `real`, `text` (also times: ISO 8601, and seconds). Beside it always stand its bytes, little-endian as on the wire: `raw`.

Two clocks: `site_time` is that of the computer that has the bus, and stands only where the bridge told it; `recorder_time` is
that of the recorder when it took the row, and always stands. Both are UTC.

    kind        what the row is                             site_time       columns of its own
    sample      a value of a PDO, or one that was read      yes             pdo, object, name, type, unit, the value, raw; problem
    state       another NMT state                           yes             text: its name
    emergency   an emergency                                yes             integer: its code, raw: register and five bytes, text
    appeared    the bridge, or the node, is there
    gone        it is there no longer: a gap begins
    gap         samples that were lost                      after it        pdo, lost (none: not known how many), begun, problem
    began       a run of a recorder                                         text: the run
    written     all rows taken before are on the disk                       text: the run
    ended       the run ended in good order                                 text: the run
"""

from __future__ import annotations

import datetime
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from canopen_gateway.fleet.keys import FleetPlace
from canopen_master.motion.record_files import pyarrow_modules
from canopen_proto.datatypes import Value

if TYPE_CHECKING:
    import pyarrow

MARK: Final = b"canopen.history"
"""The key in the metadata of each file, by which it is known; its value is the version of the columns."""
VERSION: Final = b"1"
SAMPLE: Final = "sample"
STATE: Final = "state"
EMERGENCY: Final = "emergency"
APPEARED: Final = "appeared"
GONE: Final = "gone"
GAP: Final = "gap"
BEGAN: Final = "began"
WRITTEN: Final = "written"
ENDED: Final = "ended"
MOST_NAME: Final = 400
"""Characters of a name, a unit, or the text of a problem."""
_MOST_TIME: Final = (1 << 63) - 1


class HistoryRow(NamedTuple):
    """See this module's text. The times are ns since 1970."""

    recorder_time: int
    kind: str
    site_time: int | None = None
    pdo: int | None = None
    object: str | None = None
    name: str | None = None
    type: str | None = None
    unit: str | None = None
    integer: int | None = None
    real: float | None = None
    text: str | None = None
    raw: bytes | None = None
    lost: int | None = None
    begun: int | None = None
    problem: str | None = None


def exact(value: Value | None) -> dict[str, Any]:
    """Return the column that holds a value exactly; none for bytes, which `raw` has."""
    if isinstance(value, int):  # bool, too
        return {"integer": int(value)}
    if isinstance(value, float):
        return {"real": value}
    if isinstance(value, str):
        return {"text": value}
    if isinstance(value, datetime.datetime):
        return {"text": value.isoformat()}
    if isinstance(value, datetime.timedelta):
        return {"text": f"{value / datetime.timedelta(seconds=1)!r} s"}
    return {}


def plain(text: str) -> str:
    """Return a text that can be stored: half of a surrogate pair, as a device may send it, becomes an escape."""
    return text.encode("utf-8", "backslashreplace").decode()


def sound_time(time: int | None) -> int | None:
    """Return a time of another computer; None if it cannot be one."""
    return time if time is not None and 0 <= time <= _MOST_TIME else None


def schema() -> pyarrow.Schema:
    """Return the columns. Raises PackageMissingError without pyarrow."""
    arrow, _ = pyarrow_modules("a history")
    word = arrow.dictionary(arrow.int32(), arrow.string())
    when = arrow.timestamp("ns")
    kinds = {
        "recorder_time": when, "kind": word, "site_time": when, "pdo": arrow.uint16(), "object": word, "name": word, "type": word,
        "unit": word, "integer": arrow.decimal128(20, 0), "real": arrow.float64(), "text": arrow.string(), "raw": arrow.binary(),
        "lost": arrow.uint64(), "begun": when, "problem": arrow.string(),
    }  # fmt: skip
    place = [("site", word), ("bus", word), ("node", arrow.uint8())]
    return arrow.schema([*place, *((name, kinds[name]) for name in HistoryRow._fields)], metadata={MARK: VERSION})


def table_of(place: FleetPlace, rows: list[HistoryRow]) -> pyarrow.Table:
    """Return rows of a place as a table. rows: 1 or more."""
    arrow, _ = pyarrow_modules("a history")
    fields = schema()
    columns: list[Any] = [[each] * len(rows) for each in place]
    columns += [list(column) for column in zip(*rows, strict=True)]
    arrays = []
    for field, column in zip(fields, columns, strict=True):
        is_word = isinstance(field.type, arrow.DictionaryType)
        kind = field.type.value_type if is_word else field.type
        try:
            array = arrow.array(column, kind)
        except UnicodeEncodeError:
            array = arrow.array([each if each is None else plain(each) for each in column], kind)
        arrays.append(array.dictionary_encode().cast(field.type) if is_word else array)
    return arrow.Table.from_arrays(arrays, schema=fields)
