"""All tables and printed reports, a file for each command, laid out by `tables`."""
