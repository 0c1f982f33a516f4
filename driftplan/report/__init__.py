"""The report wing: pictures, and the driftplan command. It may import everything; nothing imports it."""
