/* Claim: at most one robot in a section that two must not share.
 *
 * Three robots and one section; any message may be lost; CRASHES crashes with a restart. A robot that
 * crashes stops working. A grant is given back only when its holder is seen to have stopped.
 *
 * No variant   grants of a majority of the configured members, durable      holds
 * AMNESIA      the same, and a crash loses the grants that were given       fails
 * LOCAL        "true if successful locally", as the mission's document has it      fails
 * ONE_PEER     one peer that does not object; the lowest number wins        fails
 * REACH        somebody works, after a crash                                is found
 */
#define N 3
#ifndef CRASHES
#define CRASHES 2
#endif
#define NOBODY 255

byte grant[N] = NOBODY;  /* whom this robot has let in; durable */
byte votes[N];           /* grants this robot holds, by granter; volatile */
bool wants[N], works[N];
byte knows[N];           /* LOCAL, ONE_PEER: who this robot has heard claim, a set */
byte crashes;

#define MAJORITY(v) (v == 3 || v == 5 || v == 6 || v == 7)
#define ALONE (works[0] + works[1] + works[2] <= 1)

#ifdef REACH
inline begin(me) { works[me] = true; assert(crashes == 0) }
#else
inline begin(me) { works[me] = true; assert(ALONE) }
#endif
inline end(me) { works[me] = false; wants[me] = false; votes[me] = 0 }

proctype Robot(byte me) {
  byte g;
  do
  :: atomic { !wants[me] && !works[me] -> wants[me] = true }
#ifdef LOCAL
  :: atomic { wants[me] && !works[me] && knows[me] == 0 -> begin(me) }
  :: atomic { works[me] -> select(g : 0 .. 2); knows[g] = (g == me -> knows[g] : knows[g] | (1 << me)); g = 0 }
  :: atomic { works[me] -> end(me); g = 0;
       do :: g < N -> knows[g] = knows[g] & ~(1 << me); g++ :: else -> break od; g = 0 }
#else
#ifdef ONE_PEER
  :: atomic { wants[me] && !works[me] -> select(g : 0 .. 2);   /* one peer hears the claim ... */
       if
       :: g != me && !works[g] && !(wants[g] && g < me) -> begin(me)   /* ... and does not object */
       :: else
       fi; g = 0 }
  :: atomic { works[me] -> end(me) }
#else
  :: atomic { wants[me] && !works[me] -> select(g : 0 .. 2);   /* ask one, and be answered */
       if
       :: grant[g] == NOBODY || grant[g] == me -> grant[g] = me;
            if :: votes[me] = votes[me] | (1 << g) :: skip fi   /* or the answer is lost */
       :: else
       fi; g = 0 }
  :: atomic { wants[me] && !works[me] && MAJORITY(votes[me]) -> begin(me) }
  :: atomic { works[me] -> end(me) }
  :: atomic { grant[me] != NOBODY && !works[grant[me]] && !wants[grant[me]] -> grant[me] = NOBODY }
#endif
#endif
  :: atomic { crashes < CRASHES -> crashes++; end(me); knows[me] = 0;
#ifdef AMNESIA
       grant[me] = NOBODY
#endif
     }
  od
}

init { atomic { run Robot(0); run Robot(1); run Robot(2) } }
