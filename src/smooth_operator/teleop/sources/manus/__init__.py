"""MANUS gloves as a source: messages, their stream, and a simulator of gloves."""
