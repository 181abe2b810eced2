"""The toolkit for cable-driven arms made of quaternion joints."""

__version__ = "0.1.0"
