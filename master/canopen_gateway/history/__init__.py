"""What a fleet was: a recorder that writes its values as Parquet (`record_fleet`), and SQL over what it wrote (`open_history`).
Needs the extra `history`. docs/fleet.md tells how to use both; layout.py has the folder, rows.py the columns.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from canopen_gateway.history.layout import HistoryFile as HistoryFile
    from canopen_gateway.history.query import History as History
    from canopen_gateway.history.query import HistoryTable as HistoryTable
    from canopen_gateway.history.query import open_history as open_history
    from canopen_gateway.history.recorder import Recorded as Recorded
    from canopen_gateway.history.recorder import record_fleet as record_fleet
    from canopen_gateway.history.rows import HistoryRow as HistoryRow
    from canopen_gateway.history.writer import HistoryWriter as HistoryWriter
else:
    from canopen_proto.lazy_names import lazy_names

    __getattr__, __dir__ = lazy_names(globals())
