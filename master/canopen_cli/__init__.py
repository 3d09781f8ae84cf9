"""The `canopen` command. `main` runs it and gives the exit status; see `problem.ExitCode` for what that means."""

from canopen_cli.app import main

__all__ = ["main"]
