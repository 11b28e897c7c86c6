"""Apps that run on headsets: their messages of hands, and the recordings that they make.

Bytes or text in, hand frames out: nothing here opens a socket. The wrist is converted to the
project's axes and its z-up world here, and left-handed frames become right-handed ones.
"""
