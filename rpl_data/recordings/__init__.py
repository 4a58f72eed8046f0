"""Open recordings of any format, and mend known faults while reading them."""
