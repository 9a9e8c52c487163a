"""Identity over time: association, reflections, lifecycle. Knows nothing of CAN and DBC files."""
