//! CPUs and priorities of threads, as Linux applies or refuses them.
#![cfg(target_os = "linux")]
#![allow(clippy::unwrap_used, missing_docs)]

use std::sync::mpsc::channel;

use downbeat_executor::*;
use rustix::process::{Resource, Rlimit, getpriority_process, getrlimit, setpriority_process, setrlimit};
use rustix::thread::{
    CapabilitySet, CpuSet, capabilities, sched_getaffinity, sched_setaffinity, set_capabilities,
};
use thread_priority::{RealtimeThreadSchedulePolicy, ThreadSchedulePolicy, thread_schedule_policy};

const FIFO: ThreadSchedulePolicy = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo);

/// Runs the test on a separate thread, whose scheduling it may change.
fn on_own_thread(test: impl FnOnce() + Send + 'static) {
    std::thread::Builder::new().name("test".into()).spawn(test).unwrap().join().unwrap();
}

fn usable_cpus() -> Vec<usize> {
    let set = sched_getaffinity(None).unwrap();
    (0..CpuSet::MAX_CPU).filter(|&cpu| set.is_set(cpu)).collect()
}

fn on_cpus(cpus: &[usize]) -> ThreadOptions {
    ThreadOptions { cpus: cpus.to_vec(), ..ThreadOptions::default() }
}

fn with_priority(priority: u8) -> ThreadOptions {
    ThreadOptions { fifo_priority: Some(priority), ..ThreadOptions::default() }
}

#[test]
fn a_thread_runs_on_the_cpus_it_is_given_and_then_wherever_it_could_before() {
    on_own_thread(|| {
        let before = usable_cpus();
        let last = *before.last().unwrap();
        on_cpus(&[last]).apply().unwrap();
        assert_eq!(usable_cpus(), [last]);
        on_cpus(&before[..1]).apply().unwrap();
        assert_eq!(usable_cpus(), before[..1]);
        ThreadOptions::default().apply().unwrap();
        assert_eq!(usable_cpus(), before);
    });
}

#[test]
fn a_thread_that_is_started_inherits_nothing_that_options_made_of_its_starter() {
    on_own_thread(|| {
        let before = usable_cpus();
        on_cpus(&before[..1]).apply().unwrap();
        let (sender, seen) = channel();
        let life = move || sender.send(usable_cpus()).unwrap();
        ThreadOptions::default().spawn("child", life).unwrap().join().unwrap();
        assert_eq!(seen.recv().unwrap(), before);
        assert_eq!(usable_cpus(), before[..1]);
    });
}

#[test]
fn what_the_program_made_of_a_thread_itself_is_inherited() {
    on_own_thread(|| {
        let first = usable_cpus()[0];
        let mut set = CpuSet::new();
        set.set(first);
        sched_setaffinity(None, &set).unwrap();
        let (sender, seen) = channel();
        let life = move || sender.send(usable_cpus()).unwrap();
        ThreadOptions::default().spawn("child", life).unwrap().join().unwrap();
        assert_eq!(seen.recv().unwrap(), [first]);
    });
}

#[test]
fn a_cpu_that_does_not_exist_is_refused_with_those_that_do() {
    on_own_thread(|| {
        let before = usable_cpus();
        for missing in [CpuSet::MAX_CPU - 1, CpuSet::MAX_CPU, usize::MAX] {
            for cpus in [vec![missing], vec![before[0], missing]] {
                let error = on_cpus(&cpus).apply().unwrap_err();
                let text = error.to_string();
                assert!(matches!(error, ThreadError::NoSuchCpu { cpu, .. } if cpu == missing), "{text}");
                let begin = format!(
                    "cannot run the thread \"test\" on CPU {missing}: this program can use the CPUs "
                );
                let usable = text.strip_prefix(&begin).unwrap_or_else(|| panic!("{text}"));
                assert!(usable.trim_start().starts_with(&before[0].to_string()), "{text}");
                assert_eq!(usable_cpus(), before);
            }
        }
    });
}

#[test]
fn a_priority_out_of_range_is_refused_with_the_range() {
    for priority in [0, 100, 255] {
        let error = with_priority(priority).spawn("servo", || panic!("must not run")).unwrap_err();
        let text = format!(
            "cannot give the thread \"servo\" the SCHED_FIFO priority {priority}: \
             priorities go from 1, the lowest, to 99"
        );
        assert_eq!(error.to_string(), text);
    }
}

#[test]
fn a_priority_is_given_and_taken_back_where_the_system_allows_it() {
    on_own_thread(|| {
        let _ = setpriority_process(None, 3);
        let (policy, niceness) = (thread_schedule_policy().unwrap(), getpriority_process(None).unwrap());
        match with_priority(7).apply() {
            Ok(()) => {
                assert_eq!(thread_schedule_policy().unwrap(), FIFO);
                let (sender, seen) = channel();
                let life = move || sender.send(thread_schedule_policy().unwrap()).unwrap();
                ThreadOptions::default().spawn("child", life).unwrap().join().unwrap();
                assert_eq!(seen.recv().unwrap(), policy, "of a thread that it started");
                ThreadOptions::default().apply().unwrap();
            }
            Err(error) => assert!(matches!(error, ThreadError::PriorityNotAllowed { .. }), "{error}"),
        }
        assert_eq!(thread_schedule_policy().unwrap(), policy);
        assert_eq!(getpriority_process(None).unwrap(), niceness);
    });
}

#[test]
fn a_priority_that_the_system_forbids_is_refused_with_what_would_allow_it() {
    on_own_thread(|| {
        forbid_realtime();
        let before = usable_cpus();
        let options = ThreadOptions { cpus: before[..1].to_vec(), ..with_priority(50) };
        let error = options.apply().unwrap_err();
        assert!(matches!(error, ThreadError::PriorityNotAllowed { priority: 50, .. }), "{error}");
        let text = error.to_string();
        assert!(
            text.starts_with(
                "the system does not allow the SCHED_FIFO priority 50 for the thread \"test\": "
            )
        );
        assert!(text.contains("- rtprio 50\" in /etc/security/limits.conf"), "{text}");
        assert!(text.contains("sudo setcap cap_sys_nice+ep /"), "{text}");
        assert_eq!(usable_cpus(), before, "what was applied before is undone");
    });
}

/// Removes the rights to real-time scheduling, as for an unprivileged user. Capabilities belong to the
/// thread; the limit belongs to the process, in which no other test needs more.
fn forbid_realtime() {
    let mut sets = capabilities(None).unwrap();
    sets.effective.remove(CapabilitySet::SYS_NICE);
    set_capabilities(None, sets).unwrap();
    let maximum = getrlimit(Resource::Rtprio).maximum;
    setrlimit(Resource::Rtprio, Rlimit { current: Some(0), maximum }).unwrap();
}

#[test]
fn launchers_refuse_options_that_the_system_refuses() {
    let missing = on_cpus(&[usize::MAX]);
    let text = Pool::with_options(2, missing.clone()).unwrap_err().to_string();
    assert!(
        text.starts_with("cannot make a pool of 2 threads: cannot run the thread \"pool-1\" on CPU "),
        "{text}"
    );
    let text = Threads::with_options(missing.clone()).unwrap_err().to_string();
    assert!(text.starts_with("cannot run the thread \"module-0\" on CPU "), "{text}");
    assert!(Scheduled::new(Linear, missing.clone()).attach().is_err());
    assert!(Pool::with_options(1, missing).unwrap().attach().is_err());
}

#[test]
fn a_thread_per_module_does_not_spin_always_at_a_priority() {
    let error = Threads::with_options(ThreadOptions { spin: Spin::Always, ..with_priority(5) }).unwrap_err();
    let start = "the thread \"module-0\" cannot spin always at the SCHED_FIFO priority 5: ";
    assert!(error.to_string().starts_with(start), "{error}");
}

#[test]
fn a_launcher_places_the_cores_thread_when_it_is_attached() {
    on_own_thread(|| {
        let last = *usable_cpus().last().unwrap();
        Scheduled::new(Linear, on_cpus(&[last])).attach().unwrap();
        assert_eq!(usable_cpus(), [last]);
    });
    on_own_thread(|| {
        let last = *usable_cpus().last().unwrap();
        Pool::with_each(vec![on_cpus(&[last]), ThreadOptions::default()]).unwrap().attach().unwrap();
        assert_eq!(usable_cpus(), [last]);
    });
}
