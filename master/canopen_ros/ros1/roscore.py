"""Watches the ROS master: rospy itself does not notice that it has gone. Standard library only: the master speaks XML-RPC."""

from __future__ import annotations

import http.client
import os
import threading
import time
import xmlrpc.client
from types import TracebackType
from typing import Final

LOST: Final = 3.0
"""Seconds without an answer until the master counts as lost."""
INTERVAL: Final = 0.5
"""Seconds between two questions."""
DEFAULT_URI: Final = "http://localhost:11311"


def master_uri() -> str:
    """Return where the master is, as all ROS programs find it."""
    return os.environ.get("ROS_MASTER_URI") or DEFAULT_URI


class _Impatient(xmlrpc.client.Transport):
    """A transport that gives up after LOST: a computer that is switched off does not refuse a connection."""

    def make_connection(self, host: tuple[str, dict[str, str]] | str) -> http.client.HTTPConnection:
        connection = super().make_connection(host)
        connection.timeout = LOST
        return connection


class RosCore:
    """The ROS master, watched by a thread while the block runs.

    It is lost if it does not answer for LOST, or if another one has taken its place: that one does not know this node.

    uri: of the ROS master; None: as `master_uri`. lost: why it counts as lost; empty while it is there.
    """

    def __init__(self, uri: str | None = None) -> None:
        self.uri = master_uri() if uri is None else uri
        self._thread = threading.Thread(target=self._watch, name="roscore", daemon=True)
        self._over = threading.Event()
        self.lost = ""

    def process_id(self) -> int | None:
        """Ask the master for its process-ID; None if it does not answer."""
        try:
            with xmlrpc.client.ServerProxy(self.uri, transport=_Impatient()) as master:
                answer = master.getPid("/ros_canopen")
        except (OSError, http.client.HTTPException, xmlrpc.client.Error):
            return None
        return answer[2] if isinstance(answer, list) and len(answer) == 3 and isinstance(answer[2], int) else None

    def __enter__(self) -> RosCore:
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._over.set()

    def _watch(self) -> None:
        first = self.process_id()
        heard = time.monotonic()
        while not self.lost and not self._over.wait(INTERVAL):
            answer = self.process_id()
            if answer is not None and first is not None and answer != first:
                self.lost = f"another ROS master has come to {self.uri}"
            elif answer is not None:
                first, heard = answer, time.monotonic()
            elif time.monotonic() - heard > LOST:
                self.lost = f"the ROS master at {self.uri} has not answered for {LOST:g} s"
