"""The assistant's door: the Model Context Protocol, by its own Python SDK. Needs the extra `mcp`.

server = assistant_server(service, session)
await server.run_stdio_async()
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from canopen_gateway.assistant.server import assistant_server as assistant_server
else:
    from canopen_proto.lazy_names import lazy_names

    __getattr__, __dir__ = lazy_names(globals())
