"""Scene -> trajectory and surface: from given poses (`surface`)."""
