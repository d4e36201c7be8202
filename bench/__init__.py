"""bench: methods that make a scene from one image, measured along the same cameras."""
