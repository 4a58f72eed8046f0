"""Build a workspace from a recipe: plan the steps, find out which are still valid, and run the others."""
