"""What tests of several rooms share: frames, scans, configurations and services made for them."""
