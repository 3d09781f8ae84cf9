"""Understand the traffic of a bus by listening only: no frame is sent, and nothing is known except what was heard."""
