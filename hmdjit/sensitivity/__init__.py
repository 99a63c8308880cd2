"""Which numbers move the flicker most: a study's derivatives, in relative terms."""
