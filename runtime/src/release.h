// Letting go of a hand that was left behind: the haptic hand went through the object and is free on the far side, and
// the graphic hand stays where it was held up, far away.
#pragma once

#include "hand.h"
#include "object.h"

namespace palmar {

struct ReleaseRule {
  double after_s;   // the haptic hand has been free, and
  double beyond_m;  // its palm farther than this from the graphic one, for so long
};

class Release {
 public:
  // Where the solver shall aim in this step: the haptic pose, or, while a left-behind hand is led round the object, a
  // point of that way near the graphic hand. The way goes off the object, around the ball that holds object and hand,
  // and straight to the haptic hand; it is only aimed at: every pose on it is the solver's, and verified.
  // `left_behind`: the haptic hand touches nothing, and while not yet active its palm is farther than the rule's.
  Configuration aim(const ReleaseRule& rule, const HandModel& hand, const CollisionObject& object,
                    const Configuration& haptic, const Configuration& graphic, bool left_behind, double dt_s);

  bool active() const { return stage_ == Stage::off || stage_ == Stage::around || stage_ == Stage::towards; }

 private:
  // `failed`: the way ended at the object again; there is no second try before the hands have met or touched.
  enum class Stage { none, off, around, towards, failed };

  Stage stage_ = Stage::none;
  double waited_s_ = 0;   // the rule's condition has held
  double stalled_s_ = 0;  // the hand did not follow
  int direction_ = 0;     // of the ways off the object, the one being tried
  Vec3 before_{0, 0, 0};  // the graphic palm a step ago
};

}  // namespace palmar
