"""Experiments beside the simulated traffic: one question each, its figures with their bounds."""
