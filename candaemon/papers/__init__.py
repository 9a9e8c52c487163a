"""The experiments of the five papers, run again beside their printed tables."""
