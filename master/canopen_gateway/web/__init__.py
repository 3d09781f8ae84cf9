"""The web door: HTTP, a WebSocket, and a page, by Starlette on Hypercorn, in the master's own loop. Needs the extra `web`.

door = await bind_web_door(port=8080)                       # before drives boot: a port in use stops nothing that moves
async with door, open_master(...) as master, open_gateway(master) as service:
    print(door.url)                                         # with the token
    await door.serve(service)
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from canopen_gateway.web.door import WebDoor as WebDoor
    from canopen_gateway.web.door import bind_web_door as bind_web_door
else:
    from canopen_proto.lazy_names import lazy_names

    __getattr__, __dir__ = lazy_names(globals())
