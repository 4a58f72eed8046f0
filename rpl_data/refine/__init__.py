"""Joint registration of the scenes on their own surfaces, started at the solution of the clicks."""
