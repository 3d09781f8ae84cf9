"""`canopen tui`: a view of a machine that stays open in a terminal: nodes, objects, emergencies, values, traffic, drives."""
