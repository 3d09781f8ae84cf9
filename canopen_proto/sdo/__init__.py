"""Service data objects: read and write the objects of a device (CiA 301 v4.2.0, 7.2.4).

client.py, server.py: the two machines. store.py: what a server serves in the plain case. request.py: what a client is asked for.
codec.py: the frames. abort.py: abort codes and who ended a transfer. Expedited and segmented transfer; block transfer is refused.
"""
