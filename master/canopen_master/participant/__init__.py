"""What runs on the buses, whoever uses it: a master, simulated devices, a tool.

participant.py    `Participant`: machines on one or several buses, commands to them, and what they report
peer.py           `Peer`: another node, as a participant reaches it
pump.py           drives the Networks by trio; bus.py: one bus of it; alarm.py: its timekeeper;
                  patient_clock.py: the time of a world that is simulated in this process
dispatch.py       hands reports to those who wait: requests.py, subscription.py
channel_claim.py  programs on one computer agree who uses the SDO channel of a node
"""
