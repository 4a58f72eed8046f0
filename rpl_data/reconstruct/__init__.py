"""Scene -> trajectory (`tracking`, `path`) and, from poses given or tracked, the surface (`surface`)."""
