"""Pictures of motions: `canopen plot`, and --plot of other commands."""
