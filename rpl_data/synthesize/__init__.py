"""New views of labelled objects, rendered from their own meshes, which their own images coloured.

Everything here works on what it is given: meshes, cameras, pictures. Which scenes that may come from, and
what is written where, is decided in `pipeline/synthesis/`.
"""
