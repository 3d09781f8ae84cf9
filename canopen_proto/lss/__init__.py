"""Layer setting services: give devices their node-ID and bit rate over the bus itself (CiA 305).

messages.py: the frames and tables that both roles share, and frames in words; slave.py: `LssSlave`, the device's side;
master.py: `LssMaster`. Sequences of many services (fastscan, assigning node-IDs, changing the bit rate of a bus) are
procedures: canopen_proto/procedures/lss_*.py.
"""
