"""Every part of the chain switched off in turn, on the same recording and clicks."""
