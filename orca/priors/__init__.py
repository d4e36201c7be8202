"""What is not in the image: depth, what lies beyond the frame, what lies in a hole. One protocol and registry each."""
