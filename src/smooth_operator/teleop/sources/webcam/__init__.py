"""Sources that track bare hands in camera pictures or in a video file, with MediaPipe."""
