"""The parts that all commands share: options, session, output, failures, questions, files."""
