"""What is wrong with a capture, from the capture alone: one question a file, in this order.

==================  ==============================================================================
``folders``         Which files cannot be read?  The entry: `lm.check`.
``counts``          Is a photograph missing?
``all_checks``      Runs the following checks; each knows what those before it found.
``pattern_faults``  Are patterns and photographs exchanged?  Can the patterns reveal T?
``light_levels``    Is there too much light, or too little?  Are black and white frames so?
``jpeg``            Did the photographs go through lossy compression?
``frame_order``     Does each frame show its own pattern?  Hypotheses: ``order_hypotheses``.
``relation``        Do the photographs follow the patterns at all, or what else explains them?
``motion``          Did something move?  Shifts between images: ``image_shift``.
``wrong_frames``    Which frames show something else, and what?
``flicker``         Was the light the same in every frame?
``linearity``       Are the photographs linear in light?
``grey_levels``     Are random grey patterns proportional to light?
``inverse_pairs``   The same questions where patterns come with their inverses (Gray code).
``refusals``        Can any estimate come from the capture?  Asked by `lm.estimate`.
``single_frame``    Is this one photograph usable?  Asked by the live rig after each.
==================  ==============================================================================

The checks share three foundations: ``survey`` reads the samples that they look at; ``pursuit``
predicts frames for the judgement of their order (also in the live rig); ``prediction`` predicts
them more exactly, for everything else. ``finding`` is what they return; ``statistics`` is what
several of them compute.
"""
