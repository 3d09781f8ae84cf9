"""Commands of `canopen fleet`."""
