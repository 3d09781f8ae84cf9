"""`canopen pdo`: the PDOs of nodes: shown, mapped, compared."""
