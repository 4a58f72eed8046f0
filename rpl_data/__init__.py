"""rpl-data."""
