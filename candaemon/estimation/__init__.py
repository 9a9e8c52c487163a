"""Motion models and filters, pure and batched. Knows nothing of CAN, identity and configuration files."""
