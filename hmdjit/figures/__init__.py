"""All figures, a file for each command, in the style of `drawing`."""
