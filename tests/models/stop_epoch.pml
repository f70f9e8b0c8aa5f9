/* The obvious latch, and a wrong one: a stop raises an epoch, a reset clears up to the one it saw, and
 * the highest wins. An old reset masks a new stop, because two presses can share an epoch. Must fail;
 * kept so that nobody proposes it again. Everything durable, no crash at all.
 */
#define N 3
#define PRESSES 2

byte epoch[N], cleared[N];
bool latched[N];
byte said, released, presses;
byte given[PRESSES];           /* epoch that each press was given */
byte ever[N], named;        /* ghosts: presses held by a robot, presses an operator saw when it reset */

#define HOLDS(r, p) (presses > p && given[p] <= epoch[r] && given[p] > cleared[r])

proctype Robot(byte me) {
  do
  :: atomic { presses < PRESSES ->
       epoch[me]++; given[presses] = epoch[me]; ever[me] = ever[me] | (1 << presses); presses++;
       said = (said > epoch[me] -> said : epoch[me]); latched[me] = true }
  :: atomic { said > epoch[me] ->
       epoch[me] = said;
       if
       :: epoch[me] > cleared[me] -> latched[me] = true;
            if :: HOLDS(me, 0) -> ever[me] = ever[me] | 1 :: else fi;
            if :: HOLDS(me, 1) -> ever[me] = ever[me] | 2 :: else fi
       :: else
       fi }
  :: atomic { released > cleared[me] -> cleared[me] = released }
  :: atomic { latched[me] && epoch[me] <= cleared[me] -> latched[me] = false;
       assert((ever[me] & ~named) == 0) }
  od
}

proctype Operator() {
  byte shown, seen;
  do
  :: atomic { shown == 0 ->  /* the display of one robot: its epoch, and the presses it knows of */
       if
       :: shown = epoch[0]; seen = ever[0]
       :: shown = epoch[1]; seen = ever[1]
       :: shown = epoch[2]; seen = ever[2]
       fi }
  :: atomic { shown > 0 ->
       named = named | seen; released = (released > shown -> released : shown);
       shown = 0; seen = 0 }
  od
}

init { atomic { run Robot(0); run Robot(1); run Robot(2); run Operator() } }
