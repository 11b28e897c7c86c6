"""A camera or a video file as a tracker: pictures, MediaPipe's hand landmarks, sides of hands."""
