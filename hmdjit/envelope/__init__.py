"""The numerical envelope: where every function is right, and how right."""
