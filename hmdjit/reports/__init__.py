"""All tables and printed reports."""
