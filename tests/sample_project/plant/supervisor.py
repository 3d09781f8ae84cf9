"""Watches a node: keeps its errors, stops it when it reports one, starts it when it has booted, and tells when it is silent."""

from __future__ import annotations

from canopen_master import Master
from canopen_proto import EmcyReceived, HeartbeatLost, NodeBooted

HEARTBEAT = 200  # ms, of the node
PATIENCE = 0.5  # s


class Supervisor:
    def __init__(self, master: Master, node_id: int) -> None:
        self.master = master
        self.node = master.node(node_id)
        self.errors: list[int] = []
        self.silent = False

    def take_errors(self) -> list[int]:
        """The errors since the last call."""
        taken, self.errors = self.errors, []
        return taken

    async def run(self) -> None:
        await self.prepare()
        with self.master.events(EmcyReceived, NodeBooted, HeartbeatLost, node=self.node) as events:
            async for event in events:
                match event:
                    case EmcyReceived(code=code) if code:
                        self.errors.append(code)
                        await self.master.nmt_stop(self.node.node_id)
                    case NodeBooted():
                        await self.prepare()
                    case HeartbeatLost():
                        self.silent = True

    async def prepare(self) -> None:
        await self.node.write((0x1017, 0), HEARTBEAT)
        self.node.supervise_heartbeat(PATIENCE)
        await self.node.start()
