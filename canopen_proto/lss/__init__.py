"""Layer setting services: give devices their node-ID and bit rate over the bus itself (CiA 305).

messages.py: the frames and tables that both roles share, and frames in words; slave.py: `LssSlave`, the device's side;
master.py: `LssMaster`. Sequences of many services are procedures: scan.py finds devices, by fastscan or by their addresses;
assign.py gives them node-IDs; bit_rate.py changes the bit rate of a bus.
"""
