"""Service data objects: read and write the objects of a device (CiA 301 v4.2.0, 7.2.4).

client.py, server.py: the two machines, with expedited and segmented transfer; request_queue.py, server_base.py: the rest of them.
request.py: what a client is asked for. access.py, store.py: what a server serves. events.py: what both report. codec.py: frames.
abort.py: abort codes and who ended a transfer. block.py: block transfer; block_sender.py and block_receiver.py are its two sides,
block_client.py and block_server.py how client and server begin and end them.
"""
