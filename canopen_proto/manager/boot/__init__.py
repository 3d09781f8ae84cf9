"""The NMT master's boot-up of a network (CiA 302-2): which nodes there are, whether they are the right ones, their configuration.

    assignment.py     `Startup` and `Assignment`: the bits of 0x1F80 and 0x1F81
    entry.py          `BootEntry`: what the master knows of one node; `entries_of` reads them from a master's dictionary
    outcome.py        `BootOutcome`: how the boot-up of a node ended, with its letter
    node_boot.py      `boot_node`: the boot-up of one node; comparison.py: `compare_node`, the same without a write
                      `NmtCommands`: NMT commands with the pause between them that the network wants
    network_boot.py   `NetworkBoot`: all nodes side by side, their start, and the running network
    member.py         `BootingNode`: a node of the network, and whether it may be started

Import from these modules.
"""
