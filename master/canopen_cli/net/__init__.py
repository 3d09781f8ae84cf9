"""The network of a machine file: `canopen net`."""
