"""Table II: poses by networks trained on our labels and on true ones."""
