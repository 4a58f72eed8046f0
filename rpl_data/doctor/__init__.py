"""The recording doctor: what is wrong with a recording, how sure, and what to do. It changes nothing."""
