"""Stray light of Sun, Earth and Moon: background, false and lost stars, exclusion angle of a star sensor.

Point-source transmittance by cause (ghosts, scatter of polished surfaces, dust, walls and vane edges of the baffle);
what Sun, Moon and Earth make of it in electrons per pixel; frames of the real sky under the light of the Sun, read out,
detected, identified. The exclusion angle is the one at which false detections or lost stars pass a stated rate
(M. Marciniak, thesis, Ryerson University, 2014).
"""
