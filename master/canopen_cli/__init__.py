"""The `canopen` command. `entry.main` starts it, `app.main` runs one command line; see `problem.ExitCode` for its exit status."""
