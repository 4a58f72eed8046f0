"""Other people's formats: one a file, with its reader and its writer together."""
