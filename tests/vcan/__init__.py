"""Tests on a real vcan."""
