"""Service data objects: read and write the objects of a device (CiA 301 v4.2.0, 7.2.4).

client.py, server.py: the two machines; request_queue.py, what waits in a client. transfer.py: what each transfer is, with a table
of its kinds and states. access.py, store.py, host.py: what a server serves. channels.py: the channels of a device. codec.py,
block.py: frames, and how a block transfer goes. events.py: what client and server report.
"""
