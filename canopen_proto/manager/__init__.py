"""The NMT master's work on a network, by CiA 302: boot-up, PDO linking, programs, parameters.

scan.py        find the nodes of a bus
boot/          boot nodes, start the network, supervise it (CiA 302-2)
linking/       PDOs for "this object feeds that one"
programs/      read and write the programs of a device (CiA 302-3)
parameters/    read all values of a node (backup), write them back (restore)
"""
