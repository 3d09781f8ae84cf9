"""The files about a machine, and what can be told without a bus: `canopen machine`, `plan`, `ros`, `data`."""
