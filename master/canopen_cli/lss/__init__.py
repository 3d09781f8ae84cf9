"""Node-IDs and bit rates over the bus: `canopen lss`."""
