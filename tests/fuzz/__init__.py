"""Fuzzing: no input makes candaemon fail otherwise than it says, send what is no number, or grow."""
