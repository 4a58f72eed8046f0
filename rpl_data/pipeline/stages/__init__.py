"""The stages of a build, one module per command: each plans its steps and runs them."""
