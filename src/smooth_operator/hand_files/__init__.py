"""Files of robot hands: the user's folder, copies of models, spec files, and vendors' models with
meshes."""
