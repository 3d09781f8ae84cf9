"""`canopen emcy`: emergencies of a bus, and the error history of a node."""
