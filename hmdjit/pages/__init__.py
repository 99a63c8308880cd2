"""Pages to forward: one HTML file of a study, or of frames rendered elsewhere."""
