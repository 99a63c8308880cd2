"""Studies: many sessions, what they say, and how sure it is."""
