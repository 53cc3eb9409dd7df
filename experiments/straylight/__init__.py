"""Stray light of Sun, Earth and Moon: background, false and lost stars, exclusion angle of a star sensor.

Point-source transmittance by cause (ghosts, scatter of polished surfaces, dust, walls and vane edges of the baffle);
the resulting electrons per pixel from Sun, Moon and Earth; frames of the real sky under the light of the Sun, read out,
detected, identified. The exclusion angle is the angle at which false detections or lost stars exceed a stated rate (M.
Marciniak, thesis, Ryerson University, 2014).
"""
