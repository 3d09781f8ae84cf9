"""Completion for shells: `canopen completion`, and the words that a shell asks for."""
