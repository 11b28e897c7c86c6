"""Sources that track bare hands in a camera's pictures or a video file, with MediaPipe."""
