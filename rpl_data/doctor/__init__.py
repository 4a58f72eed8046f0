"""The recording doctor: find what is wrong with a recording, how sure that is, and how to mend it."""
