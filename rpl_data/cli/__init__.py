"""The command `rpl`: wiring only."""
