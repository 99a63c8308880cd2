"""Speed against accuracy, measured on this machine."""
