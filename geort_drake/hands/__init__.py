"""Robot hands: description, Drake model, geometry; `importers` read URDF, SDF and MJCF."""
