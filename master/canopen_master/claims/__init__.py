"""Programs of ours on one computer agree who uses which SDO channel of a node.

channel_claim.py      one long transfer at a time on a channel; CO208 names the program that has it
further_channels.py   a further channel of the device (0x1201 to 0x127F), if its file has one and it answers there
"""
