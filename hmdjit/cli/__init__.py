"""The command line: a file for each command; `main` lists them."""
