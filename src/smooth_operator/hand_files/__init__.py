"""Files of robot hands: the user's folder, copies of models, writing of descriptions, the vendors'
models with their meshes."""
