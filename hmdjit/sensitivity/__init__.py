"""Which numbers move the flicker most: slopes of a study."""
