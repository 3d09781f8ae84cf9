"""The traffic of a bus or a recording: `canopen monitor`, `watch`, `top`, `listen`, `log`."""
