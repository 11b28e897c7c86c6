"""Robot hands: description, loading, coupled joints, kinematics, catalogue."""
