"""Pictures of the crop: plants as triangles, a library of rendered scenes, and the encoder that makes a few numbers of each."""
