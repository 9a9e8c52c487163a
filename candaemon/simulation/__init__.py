"""Simulation: a scenario into truth, detections and the frames of any configured sensor."""
