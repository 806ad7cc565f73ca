"""What is wrong with a capture, from the capture alone: one subject a file, in this order.

==================  ==============================================================================
``all_checks``      The entry: which files cannot be read?  Runs the following checks.
                    Are patterns and photographs exchanged?  Can the patterns reveal T?
                    Is a photograph missing?
``levels``          Is there too much light, or too little?  Are black and white frames so?
                    Did the photographs go through lossy compression?
``relation``        Do the photographs follow the patterns at all, or what else explains them?
                    Does each show its own pattern?
``code_order``      The same of stripes, by how far apart neighbouring camera pixels see.
``code_frames``     Is a frame of stripes white or black, dimmed, or are greys too dark?
``motion``          Did something move by pixels?
``wrong_frames``    Which frames show something else, and what?
``inverse_pairs``   Frames and motion where patterns come with inverses (Gray code).
``refusals``        Can any estimate come from the capture?  Asked by `lm.estimate`.
==================  ==============================================================================

The checks share two foundations: ``survey`` reads the samples that they look at, and ``prediction``
predicts what frames should show. ``finding`` is what they return. What the rig did in the course of
the capture (light, curves, shake) takes an estimate of T: see `rig_model/`.
"""
