"""Datasets of star frames with exact truth: thousands of frames of the real sky, for whoever builds star sensors.

Every frame is the real sky through a traced lens, read out with noise, beside a table that says where each star truly
is. Frame k is the same bytes whether it is made alone, in any order, or by many workers. What was made stays: run the
same command again after an interrupt, a killed machine or a full disk, and it goes on where it stopped; ask for more
frames, and the dataset grows.

Rooms: ``frames`` makes one frame, ``truth`` says what is true of it, ``production`` makes many and resumes what was
interrupted, ``exports`` writes what others read, ``evaluation`` looks at the frames as others will.
"""
