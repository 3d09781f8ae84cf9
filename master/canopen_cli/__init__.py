"""The `canopen` command. entry.py starts it, app.py is the command line; see `problem.ExitCode` for its exit status."""
